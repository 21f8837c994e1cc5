"""A convolutional trunk whose features are tapped at several depths, and run so that few of them are in memory."""

from __future__ import annotations

from collections.abc import Iterator

from torch import Tensor, nn


class Trunk(nn.Module):
    """A network of convolutions whose features are taken at several layers.

    Attributes:
        channels: of every tap.
        ends: index after the last layer of every tap.
        halos: for every stage, rows that its convolutions look beyond; None: the stage is run on the whole image.
            A stage with a halo begins after its pooling, keeps the height, and is followed by pooling that halves it.
        minimum: least height and width of an image, in pixels.
        features: the layers, named and numbered as torchvision's.
    """

    channels: tuple[int, ...]
    ends: tuple[int, ...]
    halos: tuple[int | None, ...]
    minimum: int
    features: nn.Sequential

    def taps(self, images: Tensor, band: int = 16) -> Iterator[tuple[int, Tensor]]:
        """Yield the features from the first tap to the last, some rows at a time.

        The rows of a tap come from top to bottom. What a tap has given is no longer held when the next is taken.

        Args:
            images: (n, 3, h, w).
            band: rows of a band where a stage allows bands; even.

        Yields:
            The tap's number, and (n, channels, rows, w') features of it; not to be changed.
        """
        state, start = images, 0
        for tap, (end, halo) in enumerate(zip(self.ends, self.halos)):
            stage = self.features[start:end]
            if halo is None or state.shape[2] <= band + 2 * halo:
                state = stage(state)
                yield tap, state
                start = end
            else:
                # The pooling that follows is done here too, so that no full map of this stage ever exists.
                pool, (count, _, height, width) = self.features[end], state.shape
                pooled = state.new_empty((count, height // 2, width // 2, self.channels[tap])).permute(0, 3, 1, 2)
                for top in range(0, height, band):
                    bottom = min(top + band, height)
                    above, below = max(top - halo, 0), min(bottom + halo, height)
                    rows = stage(state[:, :, above:below])[:, :, top - above : bottom - above]
                    yield tap, rows
                    if bottom - top > 1:
                        pooled[:, :, top // 2 : bottom // 2] = pool(rows)
                    del rows
                state, start = pooled, end + 1


def convolution(inputs: int, outputs: int, size: int, stride: int = 1, padding: int | None = None) -> list[nn.Module]:
    """Make a convolution and its rectifier, by default padded to keep the size."""
    return [
        nn.Conv2d(inputs, outputs, size, stride, size // 2 if padding is None else padding),
        nn.ReLU(inplace=True),
    ]
