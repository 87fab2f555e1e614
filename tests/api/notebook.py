# %% [markdown]
# # From measured casts to a string, a prediction and a motion
# A notebook as a plain script: editors and Jupytext show its cells (`jupytext --to
# ipynb notebook.py`), and `tests/api/test_notebook.py` runs it. Units are metres,
# seconds and radians.

# %%
import numpy as np

import stringcast as sc

# %% [markdown]
# ## Trials
# Those that come with the package; else `sc.read(folder)` of a run of ours or of what
# `import` wrote, or tables by `sc.trials(...)`. The format is in `data/README.md`.

# %%
trials = sc.sample()
print(trials.table)

# %% [markdown]
# ## The string that they show
# Least squares on all trials, with 95 % intervals. Settings go along as words, as on
# the command line.

# %%
found = sc.estimate(
    trials, "string.points=12", "estimate.screening=32", "estimate.starts=4"
)
print(found.sentence)
print(found.parameters[["name", "value", "low", "high", "unit", "determined"]])
print(
    f"{1e3 * found.rms:.1f} mm root mean square between measured and simulated points"
)

# %% [markdown]
# ## What it would do in a motion
# Here: in one that is planned for a target with the string that was found.

# %%
motion = sc.generate(found.string, target=(0.5, 0.5))
string = sc.simulate(found.string, motion)
tip = string[string["s"] == string["s"].max()]
nearest = float(np.hypot(tip["x"] - 0.5, tip["y"] - 0.5).min())
print(
    f"a motion of {motion.duration:.2f} s brings the simulated tip within {1e3 * nearest:.0f} mm of the target"
)

# %% [markdown]
# ## Why the simulation disagrees
# The residual above is more than the noise of these points (0.7 mm). A diagnosis says
# why. It takes a minute:
#
#     result = sc.diagnose(trials)
#     result.sentence, result.causes, result.gain
#     result.report("page.html")
#     motion = sc.generate(result.extended_model, target=(0.5, 0.5))
