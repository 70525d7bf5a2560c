"""The platform-independent front end: the device, its resources and its commands, with all checks and
policies."""
