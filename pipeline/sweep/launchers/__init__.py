"""Who runs the jobs of a sweep, a file each, chosen by `hydra/launcher=`; their settings are in `conf/hydra/launcher`.

A launcher is a generator function: from attempts, which can be pickled and are called with a number of threads, it
yields the key of each when it has ended. What became of it stands in the ledger.
"""
