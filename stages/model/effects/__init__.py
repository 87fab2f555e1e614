"""Effects, one in each file. `stages.model.library` finds them."""
