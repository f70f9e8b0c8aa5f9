"""How two replicas become equal with few frames.

`synchronizer` asks and answers, `digest_comparison` finds where replicas differ, `replica` applies
what arrives. `map_sync` does the same for tiles of a map.
"""
