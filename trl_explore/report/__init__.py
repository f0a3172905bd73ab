"""The report: from finished jobs to figures, tables and one HTML page.

``loading``         folders to jobs, and what is missing among them
``groups``          which configurations stand side by side; ``labels`` what they are called
``evidence``        everything computed, once; ``curves`` the learning curves
``style``           colours, markers, lines, sizes: the one visual language
``figures``         one kind of figure per file: arrays and an ``Axes`` in
``drawing``         from evidence to drawn figures; ``captions`` what to see in them
``catalogue``       which figures there are; ``render`` the same bytes each time
``tables``          a table as HTML, CSV, LaTeX, Markdown
``results_tables``  the tables of numbers; ``claims_table`` that of verdicts
``page``            the HTML page; ``prose`` its sentences, ``theme`` its colours
``build``           all of it into a folder
"""
