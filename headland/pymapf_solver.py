"""Importing it registers the solver `headland` in the package pymapf."""

from tools.run.pymapf_solver import HeadlandSolver

__all__ = ["HeadlandSolver"]
