"""Reference simulators that make synthetic datasets with hidden causes."""
