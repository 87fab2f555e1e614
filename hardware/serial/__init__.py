"""A real arm over a serial port: its protocol, the host's side, the device's side, and
a device to rehearse with.
"""
