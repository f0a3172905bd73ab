"""The report: from finished jobs to figures, tables and one HTML page.

``loading``     reads the jobs in folders; finds what is missing, pilots and repeats
``study_file``  a YAML file that says what is asked; ``selecting`` finds which configurations it
                means and decides its claims
``factors``     what differs between configurations, and their labels
``questions``   which configurations differ in one factor only; which factors are confounded
``groups``      configurations with one environment and stopping rule; ``layouts`` arranges them
``curves``      what was recorded during training
``evidence``    every result, computed once; ``decomposition`` why strategies differ
``sentences``   the results in words; ``why`` acting, bias and data in words and tables
``methods``     settings, the methods paragraph, references
``style``       colours, markers, lines; a figure as reproducible SVG, PNG and PDF
``figures``     conditions, drawings and captions of all figures
``tables``      a table as CSV, LaTeX, Markdown; ``results_tables`` numbers, ``verdicts`` claims
``page``        the HTML page, from ``page.html``; ``build`` writes everything to a folder
"""
