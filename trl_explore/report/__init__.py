"""The report: from finished jobs to figures, tables and one HTML page.

``loading``        reads the jobs in folders; lists what is missing
``groups``         which configurations are compared; ``layouts`` how they are arranged
``labels``         the names of configurations for readers
``curves``         what was recorded during training
``evidence``       every result, computed once; ``decomposition`` why strategies differ
``sentences``      the results in words; ``why`` acting, bias and data in words and tables
``style``          colours, markers, lines; a figure as reproducible SVG and PNG
``figures``        conditions, drawings and captions of all figures
``tables``         a table as CSV, LaTeX, Markdown; ``results_tables`` numbers, ``claims`` verdicts
``page``           the HTML page, from ``page.html``; ``build`` writes everything to a folder
"""
