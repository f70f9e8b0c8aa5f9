"""Single parts of the system on the real wire model, for benches and tests only.

`sync_rig` runs replicas without the rest of a peer.
`segments_rig` runs whole peers of many segments in one loop, `bridged_processes` the same as
processes, each of which is a `segment_process`.
"""
