"""How kernels are compiled: by numba when they are first called, or before the robot starts.

Every kernel of `agent/` is decorated with the njit of `kernel`. This is the lowest package: kernels of
all others import it. `agent/runtime/ready_kernels.py` loads what `tools/build/kernel_module.py` makes.
"""
