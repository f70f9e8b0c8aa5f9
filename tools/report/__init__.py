"""`headland report`: one run as one page of HTML.

`run_data` reads what a run left. `timeline` and `tracking_error` say what happened when, and how far
robots were off their lines. `chapter` makes a picture, a table and a CSV of each subject, by
`figures`, and `page` puts them together. `planned_aside` has one of the subjects done by a second
process.
"""
