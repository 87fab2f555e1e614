"""The settings, a folder for each group; Hydra finds them as `pkg://stringcast.conf`."""
