"""Execute: perform a motion with an arm and film it with a camera, or rehearse that."""
