"""Threads of NumPy's and SciPy's linear algebra."""

# To be set before NumPy is imported. The matrices here are small: more threads are no faster, and wait actively.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # environment variables
