"""The MCAP format: its records, files with damage, and the definitions of message types that it stores."""
