"""``simgap app``: the command line in the browser, on this machine only.

`forms` makes fields from the parameters of commands, `runs` keeps what was uploaded and filled in in a folder, `jobs` runs
commands in child processes, `record` keeps how they ended, `preview` draws recordings, `guard` decides who is answered,
`server` holds the routes, `pages` the HTML, `answers` what the pages show of the written JSON. See docs/decisions/app.md.
"""
