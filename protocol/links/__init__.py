"""Buses: python-can, socketcand and the zenoh backbone. The only modules of this layer with I/O."""
