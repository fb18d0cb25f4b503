"""The report of a diagnosis.

content         the content of report.json: findings as data
sentences       the wording that terminal and page share
terminal        the text in the terminal
html            the HTML page; its style is page.css
html_findings   the findings on the page
html_tables     the numbers on the page
quantities      numbers, units and symbols for a reader
changes         values before the repair, and shifts that are shorter than a row
next_steps      what to do after the diagnosis
figures         the figures of the page
repaired_files  the repaired vehicle file and the repaired track file
residual_file   the residuals over time, as residuals.npz
effect_help     help on the effects of the catalogue
"""
