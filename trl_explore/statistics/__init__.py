"""Statistics of trials: pure functions, arrays in, arrays or small records out.

``outcomes``    what one configuration measured (the input of everything here)
``estimates``   a number with its interval
``bootstrap``   percentile bootstrap over trials; random streams by label
``proportions`` pass rate
``survival``    time to convergence: Kaplan-Meier, median, restricted mean, running time
``scores``      final score
``summary``     all of these for one configuration
``pairing``     same seed and trial: pairs, pooling, trials counted twice
``differences`` difference of two means; ``permutation`` its tests
``rank_tests``  log-rank test, probability of being faster
``comparisons`` two configurations, and all pairs with Holm's correction
``choices``     which correction, baseline or policy, and what readers call it
``effects``     what options do to rows, and a plane of numbers, in sentences
``power``       how many trials a difference needs
``claims``      the statements of the thesis, decided; ``answer`` all of it in three sentences
"""
