"""Parts of the system alone on the real wire model, for benches and tests only."""
