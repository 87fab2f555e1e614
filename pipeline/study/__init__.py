"""The blind study: benches that hide a cause, diagnosed, and only then their envelopes opened and scores made."""

from pipeline.study.benches import one_bench, study
from pipeline.study.pictures import pictures
from pipeline.study.scores import scores

__all__ = ["one_bench", "pictures", "scores", "study"]
