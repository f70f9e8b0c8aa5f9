"""Kernels that step whole fleets at once: opponents for benches, used by no robot."""
