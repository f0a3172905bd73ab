"""The report: from finished jobs to figures, tables and one HTML page.

``loading``         folders to jobs, and what is missing among them
``groups``          which configurations stand side by side; ``labels`` what they are called
``designs``         how they are laid out: crossed with options, or a plane of two numbers
``evidence``        everything computed, once; ``curves`` what was recorded
                    along the runs
``style``           colours, markers, lines, sizes: the one visual language
``figures``         one kind of figure per file: arrays and an ``Axes`` in
``drawing``         from evidence to drawn figures; ``captions`` what to see in them
``panels``          the same for layouts and recordings, with ``layout_captions``
``kinds``           which figures there are; ``catalogue`` draws them; ``render`` the same bytes each time
``tables``          a table as HTML, CSV, LaTeX, Markdown
``results_tables``  the tables of numbers; ``claims_table`` that of verdicts
``why``             the section on the bias and on what remains without it
``page``            the HTML page; ``prose`` its sentences, ``theme`` its colours
``build``           all of it into a folder
"""
