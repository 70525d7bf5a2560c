"""The parts that all objects of one device share: timeline, render states, ring memory, fixed-size
containers."""
