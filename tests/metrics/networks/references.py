"""The trunks again, as bare functional calls on torchvision-named tensors: what the modules are compared with."""

import torch
from torch.nn import functional as f


def conv(state, name, x, **kwargs):
    return f.conv2d(x, state[f"{name}.weight"], state.get(f"{name}.bias"), **kwargs)


def alex(state, x):
    taps = [f.relu(conv(state, "features.0", x, stride=4, padding=2))]
    taps.append(f.relu(conv(state, "features.3", f.max_pool2d(taps[-1], 3, 2), padding=2)))
    taps.append(f.relu(conv(state, "features.6", f.max_pool2d(taps[-1], 3, 2), padding=1)))
    for layer in (8, 10):
        taps.append(f.relu(conv(state, f"features.{layer}", taps[-1], padding=1)))
    return taps


def vgg(state, x):
    taps = []
    for number, layers in enumerate(((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))):
        x = f.max_pool2d(x, 2) if number else x
        for layer in layers:
            x = f.relu(conv(state, f"features.{layer}", x, padding=1))
        taps.append(x)
    return taps


def squeeze(state, x):
    def fire(number, x):
        narrow = f.relu(conv(state, f"features.{number}.squeeze", x))
        wide = [
            f.relu(conv(state, f"features.{number}.expand1x1", narrow)),
            f.relu(conv(state, f"features.{number}.expand3x3", narrow, padding=1)),
        ]
        return torch.cat(wide, dim=1)

    taps = [f.relu(conv(state, "features.0", x, stride=2))]
    for first, second in ((3, 4), (6, 7)):
        taps.append(fire(second, fire(first, f.max_pool2d(taps[-1], 3, 2, ceil_mode=True))))
    taps.append(fire(9, f.max_pool2d(taps[-1], 3, 2, ceil_mode=True)))
    for number in (10, 11, 12):
        taps.append(fire(number, taps[-1]))
    return taps


def blur(x):
    """Every second sample of a 3x3 binomial mean, two samples reflected, written as nine shifted sums."""
    x = f.pad(x, (2, 2, 2, 2), mode="reflect")
    height, width = x.shape[2] - 2, x.shape[3] - 2
    line = (1, 2, 1)
    total = sum(line[i] * line[j] * x[:, :, i : i + height, j : j + width] for i in range(3) for j in range(3))
    return (total / 16)[:, :, ::2, ::2]


def st_alex(state, x):
    taps = [f.relu(blur(conv(state, "features.0", x, padding=2)))]
    taps.append(f.relu(conv(state, "features.5", blur(f.max_pool2d(taps[-1], 3, 1)), padding=2)))
    taps.append(f.relu(conv(state, "features.9", blur(f.max_pool2d(taps[-1], 3, 1)), padding=1)))
    for layer in (11, 13):
        taps.append(f.relu(conv(state, f"features.{layer}", taps[-1], padding=1)))
    return taps


def st_vgg(state, x):
    taps = []
    for number, layers in enumerate(((0, 2), (6, 8), (12, 14, 16), (20, 22, 24), (28, 30, 32))):
        x = blur(f.max_pool2d(x, 2, 1)) if number else x
        for layer in layers:
            x = f.relu(conv(state, f"features.{layer}", x, padding=1))
        taps.append(x)
    return taps


ALL = {"alex": alex, "vgg": vgg, "squeeze": squeeze, "st-alex": st_alex, "st-vgg": st_vgg}


def distance(taps, heads):
    """Sum over taps of the mean weighted squared difference of unit features; (maps, value)."""
    maps = []
    for features, head in zip(taps, heads):
        unit = features / (features.pow(2).sum(dim=1, keepdim=True).sqrt() + 1e-10)
        maps.append(((unit[1] - unit[0]).pow(2) * head.reshape(-1, 1, 1)).sum(dim=0))
    return maps, sum(float(each.mean()) for each in maps)
