"""Fit vanilla 3D Gaussian splatting to photos, on the CPU: ``python examples/train_lund.py FOLDER OUT``."""

import sys
from pathlib import Path

import torch
from gsplat import DefaultStrategy
from photos import Progress, compute_loss, load, start

from hybridworldsim.rasterizer import rasterization  # the line that a gsplat user changes

torch.manual_seed(0)
steps, photos = 3000, load(Path(sys.argv[1]), width=512)
splats, optimizers, decay = start(photos, steps)
strategy = DefaultStrategy(refine_start_iter=200, refine_stop_iter=1000)
strategy.check_sanity(splats, optimizers)
state = strategy.initialize_state(scene_scale=0.1 * photos.extent)  # a street is longer than its objects


def render(index: int, degree: int = 3) -> tuple[torch.Tensor, dict]:
    """Render the image (height, width, 3) of a photo's camera; also return the meta for the strategy."""
    images, _, meta = rasterization(
        splats["means"], splats["quats"], splats["scales"].exp(), splats["opacities"].sigmoid(),
        torch.cat([splats["sh0"], splats["shN"]], 1), photos.viewmats[[index]], photos.Ks[[index]],
        photos.width, photos.height, sh_degree=degree, near_plane=0.2, packed=False)  # fmt: skip
    return images[0], meta


progress = Progress(photos, render, Path(sys.argv[2]))
for step in range(steps + 1):
    index = photos.train[int(torch.randint(len(photos.train), ()))]
    image, meta = render(index, min(4 * step // steps, 3))
    strategy.step_pre_backward(splats, optimizers, state, step, meta)
    compute_loss(image, photos.images[index]).backward()
    for optimizer in optimizers.values():
        optimizer.step()
        optimizer.zero_grad()
    decay.step()
    strategy.step_post_backward(splats, optimizers, state, step, meta)
    if step % 250 == 0:
        progress.report(step, len(splats["means"]))
progress.save()
