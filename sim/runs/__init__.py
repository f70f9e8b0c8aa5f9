"""One run of each mission, from a setup to an outcome, and the records of the work done."""
