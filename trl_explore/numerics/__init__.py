"""Compiled arithmetic, its cache on disk, and random streams; knows no reinforcement learning.

Each operation has one formula, written twice: in torch, for any device, shape and dtype, and
compiled, for flat frames on the CPU. No sum runs over the frames of more than one trial, and
every sum runs in the order of the frames, so that a trial does not depend on its neighbours.

Import from the modules: this package imports none of them, so that ``numerics.streams`` needs
neither numba nor torch.
"""
