"""Changes values of nested mappings and lists by dotted keys such as `gates.2.position`."""


def set_value(content, key: str, value) -> None:
    """Set the value at a dotted key of `content`, whose numbers count in lists; None removes it."""
    *path, last = (int(part) if part.isdigit() else part for part in key.split("."))
    place = content
    for part in path:
        place = place[part]
    if value is None:
        place.pop(last)
    else:
        place[last] = value
