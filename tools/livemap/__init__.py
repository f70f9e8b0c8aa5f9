"""The live map: a server that listens on the bus and a page that shows it.

`server` serves the page, `map_state` is what it shows, `page_updates` what is sent to it,
`stop_panel` what a person presses, `playback` a run from its recording. The page itself is in
`page`. `fleet_topics` is the fleet for Foxglove: `foxglove_live` publishes it, `recorded_topics` keeps
it.
"""
