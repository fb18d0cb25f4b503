"""An identification as text for the terminal."""

from swift_ros.text import align


def text(result: dict) -> str:
    """Return the tables of result.json: identified values, errors on held-out blocks, refusals with their reason."""
    blocks = []
    found = [row for row in result["coefficients"] if "value" in row]
    if found:
        rows = [("coefficient", "before", "value", "standard error", "unit")]
        rows += [
            (row["name"], f"{row['before']:.5g}", f"{row['value']:.5g}", f"{row['standard_error']:.2g}", row["unit"])
            for row in found
        ]
        rows += [
            (row["name"], "", f"{row['value']:.5g}", f"{row['standard_error']:.2g}", row["unit"])
            for row in result["recording"]
        ]
        blocks.append(align(rows))
    errors = [
        (name, f"{row['before']:.4g}", f"{row['after']:.4g}", row["unit"])
        for part in result["parts"].values()
        for name, row in part.get("held_out_rmse", {}).items()
    ]
    if errors:
        blocks.append(align([("RMS error on unseen blocks", "before", "after", "unit"), *errors]))
    lines = []
    for name, part in result["parts"].items():
        lines += [f"{name}: not fitted, {part['missing']}"] if part.get("missing") else []
        lines += [f"{name}: {note}" for note in part.get("notes", ())]
    refused = [row for row in result["coefficients"] if "refused" in row]
    lines += [f"refused {row['name']}: {row['refused']}; to identify it, {row['fly']}" for row in refused]
    lines += ["identified values hold with the refused coefficients at the file's values"] if found and refused else []
    return "\n\n".join([*blocks, "\n".join(lines)] if lines else blocks)
