"""An arm of Dynamixel servos (X series, protocol 2.0) on one bus."""
