"""Room that is used again, and never twice at once."""

import numpy as np
import torch

from hybridworldsim.kernels.memory import empty_aligned, full_aligned

LARGE = 1 << 20


def test_room_is_aligned_and_has_its_size():
    for count, dtype in ((0, np.float32), (1, np.float64), (1001, np.int32), (LARGE, np.int64)):
        numbers = empty_aligned(count, dtype)
        assert numbers.shape == (count,)
        assert numbers.dtype == dtype
        assert numbers.ctypes.data % 64 == 0 or count == 0
    assert (full_aligned(7, 2.5) == 2.5).all()


def test_what_is_referred_to_is_not_given_out_again():
    first = empty_aligned(LARGE)
    place = first.ctypes.data
    tensor, view = torch.from_numpy(first[8:]), first[100:200]
    del first
    others = [empty_aligned(LARGE) for _ in range(3)]
    assert place not in [other.ctypes.data for other in others]
    del tensor
    assert empty_aligned(LARGE).ctypes.data != place
    del view
    given = [empty_aligned(LARGE) for _ in range(40)]
    assert place in [one.ctypes.data for one in given]
    assert len({one.ctypes.data for one in given}) == len(given)
