"""The images in a folder."""

from pathlib import Path

from swift_ros.errors import UsageError

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


def image_files(
    folder: Path, advice: str = "give a folder of images", suffixes: tuple[str, ...] = SUFFIXES
) -> list[Path]:
    """Return the images in a folder and below it, in the order of their names.

    Args:
        folder: the folder.
        advice: what to do about an error.
        suffixes: of the names of images, in lower case.

    Raises:
        UsageError: it is no folder, or has no image.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is not a folder; {advice}")
    found = sorted(file for file in folder.rglob("*") if file.suffix.lower() in suffixes and file.is_file())
    if not found:
        raise UsageError(f"{folder} holds no image ({', '.join(suffixes)}); {advice}")
    return found
