"""``simgap app``: the flow from a model to a diagnosis in the browser, on this machine only.

`runs` keeps what was uploaded and answered in a folder, `jobs` runs ``simgap check`` and ``simgap diagnose`` in child processes,
`guard` decides which requests are answered, `server` holds the routes, `pages` the HTML, `answers` what the pages show of the
written JSON. See docs/decisions/app.md.
"""
