"""Kernels that step whole fleets together: opponents for benches, used by no robot."""
