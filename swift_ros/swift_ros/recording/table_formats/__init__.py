"""The rows of CSV and Parquet tables: all that can be read, and the names of those that cannot."""
