"""Runs that other programs wrote, read as curves of scores.

``log``          a run as its files hold it; its curve without restarts and duplicates
``sb3``, ``tensorboard``, ``csv_files``
                 the readers, one for each kind of files
``identify``     which configuration, environment and seed a run has, from folders and columns
``readers``      the readers by name, and the runs of any number of folders
``measures``     the measures of the runs of one environment, and their comparison

What only this program records (the behaviour policy, the learned score, visits) is not guessed.
"""
