"""Images for the gate detector: where they come from and their labels."""
