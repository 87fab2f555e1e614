"""The forward model, of hand, string and camera, which all else uses."""
