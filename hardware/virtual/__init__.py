"""A virtual lab: an arm, a string and a camera that can surprise the model. No stage imports it."""
