"""The platform-independent half of the interface: what users hold, and every policy that a platform must not decide."""
