"""What emulated arms have in common: joints that hang by wires, and a pseudo-terminal to be spoken to."""
