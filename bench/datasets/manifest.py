"""What can be fetched, from where, and what it must be.

Hashes of VistaDream's videos were taken from copies of the published files; that of DIV2K's archive is the one that
TensorFlow Datasets records for it. RealmDreamer's images are kept converted (alpha dropped, 512x512), so what is pinned
is the SHA-256 of the converted pixels. VistaDream's depth videos are not pinned, since none of them was at hand when
this was written: they are not fetched, only named.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DIV2K", "IMAGES", "REALMDREAMER_SCENES", "VIDEOS", "Archive", "Image", "Video", "depth_video_url"]

_PAGE = "https://vistadream-project-page.github.io/visual"
_REALMDREAMER = (
    "https://raw.githubusercontent.com/jaidevshriram/realmdreamer/e703c44834a8285a52c3b506a0a32d1a80de2dd4/data/images"
)


@dataclass(frozen=True)
class Video:
    """A file that is kept as it is; ``path`` is relative to the data root."""

    path: str
    url: str
    size: int
    sha256: str


@dataclass(frozen=True)
class Image:
    """An image that is converted to 512x512 RGB; ``pixels_sha256`` is over those 786,432 bytes."""

    path: str
    url: str
    pixels_sha256: str


@dataclass(frozen=True)
class Archive:
    """An archive that is unpacked below ``folder``; ``members`` are what it must hold."""

    folder: str
    url: str
    size: int
    sha256: str
    members: tuple[str, ...]


def depth_video_url(scene: str) -> str:
    """Where VistaDream published the depth video of a scene; its content is not pinned."""
    return f"{_PAGE}/dpt/{scene}.mp4"


DIV2K = Archive(
    folder="div2k",
    url="https://data.vision.ee.ethz.ch/cvl/DIV2K/DIV2K_valid_LR_bicubic_X2.zip",
    size=117_763_600,
    sha256="60eed9875c697df51204aa579e2a699e1d5215095788a097ff54dd17e2664d57",
    members=tuple(f"DIV2K_valid_LR_bicubic/X2/{number:04d}x2.png" for number in range(801, 901)),
)

# (size, SHA-256) of visual/rgb/<scene>.mp4 and visual/rgb/coarse/<scene>.mp4
_VIDEOS = {
    "bathroom": (
        (1313842, "160db679ad3f9f9b9e6174353e3ca830c9bda0ee3b0521ac34343c37a6c6abd9"),
        (1008974, "f0e6023421e6bbb993bffb65ec20135f1c2b73c179450cedc17e74ff7538c6f0"),
    ),
    "bear": (
        (926421, "5dbbe39162d1ae88efa9a0522a521b048becd61201b2ded4fcde40630bc5ee23"),
        (1092147, "59cd3c51a250ca0530634193f6105417c4c247dbd547bf6f642fd7fdef098853"),
    ),
    "bedroom3": (
        (622088, "47273f0f35add0f32dc3321abea88946afb592dd2268e6683e228da9cc9341d0"),
        (659672, "8ef007b8edcb45438e62191806f33836d3fd573c9a72aedd1283f672efd7dbdb"),
    ),
    "bust": (
        (1190381, "7c625cde4c764ec9e45625b0c032d397ab6d31591773defda1afb7dce009f3d1"),
        (1209770, "7705f197664b4a66765ff6db10bc2826ec76d1cbcd77e6bfa6c81f65acd19fb5"),
    ),
    "car": (
        (1660941, "44c278d1a43973ccc40f3e4d195863faa7191f1ae03d65212481a4afbc9ae46f"),
        (1242931, "9e8215d57e45aa843e0c2d649c3fc62ef22308126c32233f4d7bb971dbe69aef"),
    ),
    "kitchen": (
        (1113911, "877bbe37687ef3e57c82c7e3a2743757f7b775c946638bc86326432989679b63"),
        (998903, "a107196b9cf4c3c23cb0d14c63a5c6cb902d3f0e1983ea6d00058bb6c16ba2cf"),
    ),
    "lavender": (
        (387974, "b9c942a7a41477b34060a908f25ff1005dcf48328a2273f7809e5ef563db4de3"),
        (420638, "a21a70ae1f33758e20c6ff5ad7badd0b4a7702efa6a95ba663d065bd39c341d1"),
    ),
    "living_room": (
        (812358, "48400367b4b94a82916d1441847681734b44e5ceb4fb00e6798333e59bad2439"),
        (791306, "163d870360aea97a3fc6653b3aad636213037298cf9a12aa388be54594ffb094"),
    ),
    "piano": (
        (949963, "424eaf4e9f87602303c19fcb8ec8fd19fb1f16d4b95ef1706149e8cfd632b488"),
        (1087677, "8799d26ea318e278f3fe943a80b468530de41449b009f7ba70d39b0c0b3b041c"),
    ),
    "steampunk": (
        (2200883, "92cca018eb3b1dc7d939c595265c9f2924cea1cd400969e4b619546eeae9b5e3"),
        (1648191, "dcd2174b7d494d3e507856a91101c1e61e825a6909afad34a5156bd238aec234"),
    ),
    "victorian": (
        (1740022, "6970b2b3423ffa3448dfc51747266ac48b7bb819afefe6d5fbbac48901d19263"),
        (1302799, "88d009e2c27cf6390ae352965adcd1808d73a4433601bbdaf7b84c4fccc62b5e"),
    ),
}
VIDEOS = tuple(
    Video(f"vistadream/{stage}/{scene}.mp4", f"{_PAGE}/{folder}/{scene}.mp4", *facts)
    for scene, both in _VIDEOS.items()
    for (stage, folder), facts in zip((("rgb", "rgb"), ("coarse", "rgb/coarse")), both, strict=True)
)

# (file in the public repository, SHA-256 of the converted pixels)
_IMAGES = {
    "bathroom": ("bathroom2.png", "9c8db1636cd46f308c578302a9fb9e6004813ff0bf7f052b2e29e4b0e0302e82"),
    "bear": ("bear.png", "180f70e38b2e8b1d67f191c8f370e68959d72517460f056b06e6e2cdbe28148b"),
    "bedroom3": ("bedroom3.png", "5d92da93026ba9f9af3ec28a99d47bed241621beed845776f4c6feeaa82857e1"),
    "bust": ("bust.png", "4355298b137e1ae97107be886d383573769c52421473a7363538d6929e98a6c4"),
    "car": ("car.png", "89edcc852539660e61692fc534218ed9985a1f7886e04c01a5aa2430367f35e5"),
    "kitchen": ("kitchen.png", "e484da6c468d57915dcee74a11563ca07822090738f3294bea0ca0c752405e7a"),
    "lavender": ("lavender.png", "b536bfdae5224bcef481718fab4695979912c1ec6bc124bf6f1880b2cd8967d5"),
    "living_room": ("living_room.png", "a8c407aed0c3958b58760fb8dfc7526613d47ddfdef8f18022576abea91f1a31"),
    "piano": ("piano.jpg", "ff363e2b2fe5f4469ee35d491186065995f22a067e46050c68edbb4f412f4a50"),
    "steampunk": ("steampunk.jpg", "ba28947ebb1e1ee678c25e9749259562aa2c437d00ae8881da1d565fad0d0a8b"),
    "victorian": ("victorian.jpg", "b5782eb07ffa9ad14f788541def73df9c76b5343bc7e00ef8fe70adf0b476812"),
}
IMAGES = tuple(
    Image(f"realmdreamer/images/{scene}.png", f"{_REALMDREAMER}/{file}", pixels)
    for scene, (file, pixels) in _IMAGES.items()
)

# What `scenes.json` holds: focal length at 512 pixels and the ratios of VistaDream's path, recovered from its published
# videos, and (a, b) of z / R = a + b v, where v in [0, 1] is the value that its depth videos show.
REALMDREAMER_SCENES: dict[str, dict[str, float | list[float]]] = {
    "bathroom": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.2,
        "backward_ratio": 0.8,
        "depth_affine": [0.6908078938444439, 0.9989158259987292],
    },
    "bear": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.2,
        "backward_ratio": 0.8,
        "depth_affine": [0.2704895136457038, 1.338349159176831],
    },
    "bedroom3": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.2,
        "backward_ratio": 0.8,
        "depth_affine": [0.6360387051483261, 1.0151013019820747],
    },
    "bust": {
        "fx_512": 495.1183919270833,
        "forward_ratio": 0.4,
        "backward_ratio": 0.4,
        "depth_affine": [0.2824043564107794, 1.6258883492507252],
    },
    "car": {
        "fx_512": 689.2836672371456,
        "forward_ratio": 0.3,
        "backward_ratio": 0.4,
        "depth_affine": [0.7022352401170913, 7.214299966023478],
    },
    "kitchen": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.2,
        "backward_ratio": 0.8,
        "depth_affine": [0.5574076766915956, 1.220143621888855],
    },
    "lavender": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.3,
        "backward_ratio": 0.8,
        "depth_affine": [0.7835261750688057, 0.8656265518957632],
    },
    "living_room": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.3,
        "backward_ratio": 0.8,
        "depth_affine": [0.5752843764712418, 1.157011187034787],
    },
    "piano": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.2,
        "backward_ratio": 0.8,
        "depth_affine": [0.5200005005224883, 1.0329193841439217],
    },
    "steampunk": {
        "fx_512": 443.4050067376326,
        "forward_ratio": 0.3,
        "backward_ratio": 0.8,
        "depth_affine": [0.5219475090604843, 1.4558121985403996],
    },
    "victorian": {
        "fx_512": 495.4603610411809,
        "forward_ratio": 0.5,
        "backward_ratio": 0.8,
        "depth_affine": [0.5843020919188573, 1.5515916768216904],
    },
}
