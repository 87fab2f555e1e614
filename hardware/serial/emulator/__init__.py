"""An emulated device on a pseudo-terminal, with faults on request."""
