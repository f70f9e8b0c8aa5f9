"""Commands that prepare: kernels compiled ahead, the compiled core for campaigns."""
