"""The report of a diagnosis.

content         the content of report.json: findings as data
sentences       the wording that terminal and page share
terminal        the text in the terminal
html            the HTML page
figures         the figures of the page
repaired_files  the repaired vehicle file and the repaired track file
residual_file   the residuals over time, as residuals.npz
effect_help     help on the effects of the catalogue
"""
