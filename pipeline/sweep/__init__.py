"""Run sweeps: many runs by one command, on this machine or a cluster; see README.md."""
