"""Statistics of trials: pure functions from arrays to estimates.

``estimates``    a number with its interval; of proportions and quantiles
``outcomes``     the results of one configuration, by either measure; its times to convergence
``samples``      one number per trial: iterations, scores, frames; which kinds of trials are rare
``means``        means and their differences, with intervals that allow for unseen failures
``survival``     right-censored times: Kaplan-Meier, median, log-rank
``pairing``      pairs by seed and trial, pooling, shared trials
``summary``      all estimates for one configuration
``evaluations``  when a trial is evaluated, and when it has learned
``decomposition``  the parts of a difference: acting, bias, data
``comparisons``  differences of two configurations, with Holm's correction over many pairs
``sequential``   trials added until all pairs are decided, with the error held
``power``        how many trials are needed to detect a difference

Nothing is drawn at random. In all functions, ``level`` is the confidence level of every interval.
A level outside (0, 1) and empty samples or arrays of mismatched lengths raise ValueError. How often
the intervals cover and the tests err is in ``docs/statistics.md``.
"""
