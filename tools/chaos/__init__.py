"""Campaigns of chaos, the hunt for planted bugs, fuzzing, and their report."""
