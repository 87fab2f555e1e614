"""The shell: configuration, folders, seeds, progress, resuming. The only place that knows Hydra."""
