"""An arm on a serial port: protocol, host, device and a device to rehearse with."""
