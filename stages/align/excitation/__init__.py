"""Excitation: a motion of the arm that tells the most of camera and clock."""
