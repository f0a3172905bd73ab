"""The report: from finished jobs to figures, tables and one HTML page.

What is asked and compared:

``loading``     reads the jobs in folders; finds what is missing, pilots and repeats
``study_file``  a YAML file that says what is asked; ``selecting`` finds which configurations it
                means and decides its claims
``factors``     what differs between configurations, and their labels
``questions``   which configurations differ in one factor only; which factors are confounded
``groups``      configurations with one environment and stopping rule; ``layouts`` arranges them
``curves``      what was recorded during training
``crossings``   which configurations show why strategies differ; ``decomposition`` the parts
``evidence``    every result, computed once

What a reader sees comes from:

``sentences``   the answer and the sentences of a section; ``why`` those on acting, bias and data
``figures``     one function for each figure: condition, drawing, caption
``results_tables`` tables of numbers, ``verdicts`` of claims, ``why`` of the parts of a difference
``methods``     settings, the methods paragraph, references
``page``        the HTML page, from ``page.html``; ``build`` writes everything to a folder
``logs``        the page on runs of other programs; ``tuning`` that on tuned strategies

``style`` has colours, markers and lines, ``formats`` a figure as SVG, PNG and PDF, ``tables`` a
table as CSV, LaTeX and Markdown, and numbers as text.
"""
