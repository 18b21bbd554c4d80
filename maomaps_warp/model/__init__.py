"""What flows through the house: plain frozen dataclasses over NumPy arrays."""
