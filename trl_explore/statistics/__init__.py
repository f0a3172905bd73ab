"""Statistics of trials: pure functions from arrays to estimates.

``estimates``    a number with its interval; proportions with Wilson's interval
``bootstrap``    percentile bootstrap over trials; random streams by label
``permutation``  permutation tests of two means, paired and unpaired
``survival``     right-censored times: Kaplan-Meier, median, restricted mean, running time, log-rank
``outcomes``     the results of one configuration; its times to convergence
``pairing``      pairs by seed and trial, pooling, shared trials
``summary``      all estimates for one configuration
``comparisons``  differences of two configurations, with Holm's correction over many pairs
``power``        how many trials are needed to detect a difference

In all functions, ``rng`` is the source of the resampling, ``level`` the confidence level of every
interval, and ``resamples`` the number of resamples of each bootstrap and each test. A level outside
(0, 1) and empty samples or arrays of mismatched lengths raise ValueError.
"""
