"""The report: from finished jobs to figures, tables and one HTML page.

``loading``         folders to jobs, and what is missing among them
``groups``          which configurations stand side by side; ``labels`` what they are called
``evidence``        everything computed, once; ``curves`` what was recorded along the runs
``style``           colours, markers, lines, sizes: the one visual language
``figures``         one file per figure: when it applies, how it is drawn, its caption
``render``          a figure as SVG and PNG, always the same bytes
``tables``          a table as CSV, LaTeX, Markdown
``results_tables``  the tables of numbers; ``claims`` those of verdicts
``page``            the HTML page, from ``page.html``
``build``           all of it into a folder
"""
