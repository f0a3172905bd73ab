"""Statistics of trials: a library of pure functions, arrays in, estimates out.

``estimates``    a number with its interval; a proportion with Wilson's
``bootstrap``    percentile bootstrap over trials; random streams by label
``permutation``  permutation tests of two means, paired and unpaired
``survival``     right-censored times: Kaplan-Meier, median, restricted mean, running time, log-rank
``outcomes``     what one configuration measured; its times to convergence
``pairing``      same seed and trial: pairs, pooling, trials counted twice
``summary``      all estimates of one configuration
``comparisons``  difference of two means; two configurations; all pairs with Holm's correction
``power``        how many trials a difference needs
``choices``      which correction, baseline or policy, and what readers call it

In all of them ``rng`` is the source of the resampling, ``level`` the confidence level of every
interval, and ``resamples`` the number of resamples of each bootstrap and of each test. ValueError
is raised for a level outside (0, 1) and for samples that are empty or of unequal lengths.
"""
