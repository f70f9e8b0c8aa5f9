"""Pairs of numbers that stand for places, each with its axes.

A point in the field or building and a place in a grid are the same pair for Python, but their axes
differ. These names keep them apart.
"""

Point = tuple[float, float]  # metres (x, y): east and north
Polyline = tuple[Point, ...]  # from its first point to its last
Cell = tuple[int, int]  # (row, column) of a grid
GridPoint = tuple[float, float]  # (row, column); a pair of integers is the centre of that cell
