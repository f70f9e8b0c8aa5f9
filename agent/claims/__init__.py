"""Claims that get on and claims that do not, for every mission.

`claim_headway` is one robot's own side: when it gives a section back. `standing_owners` is the side
of the others: when a live robot that stands loses what it has claimed.
"""
