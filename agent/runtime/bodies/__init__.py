"""The bodies that ship: `nmea_body`, a machine with a GNSS receiver and a wheel controller, and
`replay_body`, a recorded log. `line_port` connects to serial, TCP and UDP. `nmea_fixes` reads sentences,
`bus_fixes` the messages of a CAN bus; `position_fixes` makes observations of both. `wheel_sentences` is
what a wheel controller is told. `ros2_body` is a robot with ROS 2.
"""
