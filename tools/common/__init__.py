"""What several commands share.

`options` has the options with their help, `bus_address` where a bus is, `bus_attach` the attachment to
it, `frame_makers` which frames a listener believes. `run_folder` keeps what a run leaves, and
`result_table` prints it. `fingerprint` is the hash of the code that a result came from.
"""
