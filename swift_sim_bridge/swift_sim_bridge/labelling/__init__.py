"""Labels images of gates: frames of bags and folders, proposals, the page for a person, labels without a person."""
