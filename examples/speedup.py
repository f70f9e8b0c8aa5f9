"""How much faster is a larger fleet? A sweep over robots and seeds, as a table and a picture."""

from matplotlib import pyplot

import headland as hl

frame = hl.sweep("small", robots=(1, 2, 4), seeds=range(1, 3))
mean_s = frame.groupby("robots")["makespan_s"].mean()
print(mean_s)
_, (left, right) = pyplot.subplots(1, 2, figsize=(9, 4))
mean_s.plot.bar(ax=left, ylabel="s until all is covered")
hl.play("small", robots=4, seed=1).plot("tracks", ax=right)
pyplot.savefig("speedup.png")
