"""The figures, one kind per file: arrays and an ``Axes`` in, drawn on it.

``trials``          every trial as a point (figures 2.1 to 2.4 and 3.1 to 3.3 of the thesis)
``epsilon_decay``   ε by iteration (figure 2.5)
``survival``        Kaplan-Meier curves with the numbers at risk
``learning``        learning curves with bands
``curves``          several curves on one panel
``effects``         options in blocks of rows: pass rate and iterations
``plane``           a map over two parameters
``forest``          differences of all pairs with their intervals
``power``           which difference so many trials find
"""
