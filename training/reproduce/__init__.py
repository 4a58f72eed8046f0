"""The paper's experiments, whole: `rpl reproduce --help`.

A command is a function of the module named like it: it writes `<out>/<command>.json`, a page
`<out>/<command>.html` and its figures as PNG beside them. The same options and seeds give the same
printed digits.
"""
