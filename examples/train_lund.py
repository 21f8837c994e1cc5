"""Fit vanilla 3D Gaussian splatting to photos, on the CPU: ``python examples/train_lund.py FOLDER OUT [STEPS]``."""

import sys
import time
from pathlib import Path

import cv2
import torch
from gsplat import DefaultStrategy
from photos import difference, load, psnr, start

from hybridworldsim.rasterizer import rasterization  # the line that a gsplat user changes

folder, out, steps = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 3000
torch.manual_seed(0)
photos = load(folder, width=512)
height, width = photos.pictures.shape[1:3]
splats, optimizers = start(photos)
decay = torch.optim.lr_scheduler.ExponentialLR(optimizers["means"], 0.01 ** (1 / steps))
strategy = DefaultStrategy(refine_start_iter=steps // 20, refine_every=50, refine_stop_iter=steps * 2 // 3)
strategy.check_sanity(splats, optimizers)
state = strategy.initialize_state(scene_scale=photos.extent)
test = list(range(7, len(photos.names), 8))
train = [index for index in range(len(photos.names)) if index not in test]


def render(index: int, degree: int = 3) -> tuple[torch.Tensor, dict]:
    """Picture (height, width, 3) of a photo's camera, and what the strategy reads."""
    picture, _, meta = rasterization(
        splats["means"], splats["quats"], splats["scales"].exp(), splats["opacities"].sigmoid(),
        torch.cat([splats["sh0"], splats["shN"]], 1), photos.viewmats[[index]], photos.Ks[[index]], width, height,
        sh_degree=degree, packed=False)  # fmt: skip
    return picture[0], meta


begin = time.perf_counter()
print("step,seconds,gaussians,train_psnr_db,test_psnr_db")
for step in range(steps + 1):
    index = train[int(torch.randint(len(train), ()))]
    picture, meta = render(index, min(step // (steps // 4), 3))
    strategy.step_pre_backward(splats, optimizers, state, step, meta)
    difference(picture, photos.pictures[index]).backward()
    for optimizer in optimizers.values():
        optimizer.step()
        optimizer.zero_grad()
    decay.step()
    strategy.step_post_backward(splats, optimizers, state, step, meta)
    if step % 250 == 0:
        with torch.no_grad():
            scores = [psnr(render(i)[0].clamp(0, 1), photos.pictures[i]) for i in test]
        seconds, fit = time.perf_counter() - begin, psnr(picture.detach(), photos.pictures[index])
        print(f"{step},{seconds:.0f},{len(splats['means'])},{fit:.2f},{sum(scores) / len(scores):.2f}", flush=True)
with torch.no_grad():
    for i in test:
        bgr = render(i)[0].clamp(0, 1).numpy()[..., ::-1] * 255
        cv2.imwrite(str(out / photos.names[i]), bgr)
