"""Files that people give to a robot: its keys and the outline of its field.

Read `given_file` first: every file of a user is read through it, within limits of size and depth.
`key_file` has the keys of a fleet and of an operator. `field_file` reads an outline from GeoJSON or,
by `isoxml_reader`, from ISO 11783-10 task data; every bad one is a `field_error` of one line.
"""
