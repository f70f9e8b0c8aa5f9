"""VDA 5050, version 2: the messages between a master control and vehicles, and the broker between them.

`messages` has the topics as models, `broker_link` the connection that comes back by itself.
"""
