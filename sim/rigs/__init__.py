"""Single parts of the system on the real wire model, for benches and tests only."""
