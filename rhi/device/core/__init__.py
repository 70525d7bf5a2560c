"""What all objects of one device share: time, render states, transient memory, fixed-size containers."""
