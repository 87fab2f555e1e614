"""The blind study: benches that hide a cause, diagnosed, and only then their envelopes opened and scores made."""

from stringcast.pipeline.study.benches import one_bench, study
from stringcast.pipeline.study.pictures import pictures
from stringcast.pipeline.study.scores import scores

__all__ = ["one_bench", "pictures", "scores", "study"]
