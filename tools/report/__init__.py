"""`headland report`: one run as one page.

`run_data` reads what a run left, `timeline` and `tracking_error` work it out, `chapter` writes and
`figures` draws.
"""
