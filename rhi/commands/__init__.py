"""Commands as data: the operations, a recorded stream of them, and the backend that records."""
