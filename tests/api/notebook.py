# %% [markdown]
# # Why does the simulation disagree with the camera?
# Five casts of a string were filmed. A simulation with the same hand motion does not
# end up where the camera saw the string. Something is missing in it: which physical
# cause? This notebook finds out, and then does the same for your own CSV files. The
# casts come from a virtual lab, and nobody told the software the cause.
#
# `stringcast.ipynb` is made from the plain script `notebook.py`. Units are metres,
# seconds and radians.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import stringcast as sc

# %% [markdown]
# ## The casts
# They come with the package. `sc.read(folder)` reads a run, or what the command
# `import` wrote.

# %%
trials = sc.sample()
print(trials)

# %% [markdown]
# ## The cause
# This takes a minute or two and shows its progress. The stop button ends it with what
# is known.

# %%
result = sc.diagnose(trials)
print(result)

# %% [markdown]
# Left: the string at the moment at which the simulation without the cause is most
# wrong. Right: the error on each trial, predicted from the others. The extended model
# comes down to the noise of the camera.

# %%
result.plot()

# %% [markdown]
# `result.report("page.html")` writes a page with all the evidence and films of all
# trials.

# %% [markdown]
# ## What the string would do in another motion
# Here: in one that is planned for a target with the extended model.

# %%
motion = sc.generate(result.extended_model, target=(0.5, 0.5))
string = sc.simulate(result.extended_model, motion)
tip = string[string["s"] == string["s"].max()]
nearest = float(np.hypot(tip["x"] - 0.5, tip["y"] - 0.5).min())
print(f"A motion of {motion.duration:.2f} s brings the simulated tip")
print(f"within {1e3 * nearest:.0f} mm of the target.")

# %% [markdown]
# ## Your own CSV files
# A table of joints or of the hand's pose, and one of measured points. Until you have
# your own, these lines write two of the sample, in the units and names that `trials`
# takes:

# %%
folder = Path(tempfile.mkdtemp())
for name in ("arm", "points"):
    table = pd.read_parquet(trials.folder / f"{name}.parquet")
    table.to_csv(folder / f"{name}.csv", index=False)

# %%
arm = pd.read_csv(folder / "arm.csv")  # trial, t, q1, q2, q3 [s, rad]
points = pd.read_csv(folder / "points.csv")  # trial, t, s, x, y [s, m]
mine = sc.trials(
    points,
    arm=arm,
    length=0.304,  # [m], from the grasp to the tip
    links=[0.25, 0.20, 0.135],  # [m]
    base=[0.2, 0.2],  # [m], joint 1
)
print(mine)

# %% [markdown]
# Files with other names, units or clocks: the command
# `stringcast import robot_*.csv tracker_*.csv --to mine` detects them, and
# `sc.read("mine")` reads the result. Then `sc.diagnose(mine)` as above, or only the
# parameters of the string:

# %%
found = sc.estimate(
    mine, "string.points=12", "estimate.screening=32", "estimate.starts=4"
)
print(f"{1e3 * found.rms:.1f} mm root mean square between measured and simulated")
found.plot()

# %% [markdown]
# The residual is more than the noise of these points (0.7 mm): the estimate knows
# nothing of the cause that the diagnosis found.
