"""The paper's experiments again, on the virtual lab: its numbers beside ours."""
