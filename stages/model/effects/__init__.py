"""Effects, a file each: `stages.model.library` finds them."""
