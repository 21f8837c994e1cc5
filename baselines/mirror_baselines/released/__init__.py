"""Released output of other generators as submissions: their folders of images and videos are read.

Their programs are not run and their weights are not loaded: the licences of some allow no more.
"""

from mirror_baselines.released.generators import GENERATORS, Generator
from mirror_baselines.released.submission import make_renderer

__all__ = ["GENERATORS", "Generator", "make_renderer"]
