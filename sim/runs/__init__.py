"""One run of each mission, from a setup to an outcome, and what is written of the work done."""
