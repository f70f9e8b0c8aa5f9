"""Machines that exist only as processes: what a driver connects to before there is a vehicle.

`nmea_machine` has a receiver and a wheel controller. It moves by its own integrator, so that it can judge
the drivers that share `agent/motion/wheel_kinematics.py`.
"""
