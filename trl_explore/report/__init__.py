"""The report: from finished jobs to figures, tables and one HTML page.

``loading``         reads the jobs in folders; lists what is missing
``groups``          which configurations are compared; ``labels`` their names for readers
``evidence``        every result, computed once; ``curves`` what was recorded during training
``style``           colours, markers, lines and sizes of all figures
``figures``         one file per figure: condition, drawing, caption
``render``          a figure as reproducible SVG and PNG
``tables``          a table as CSV, LaTeX, Markdown
``results_tables``  the tables of numbers; ``claims`` the tables of verdicts
``page``            the HTML page, from ``page.html``
``build``           writes everything to a folder
"""
