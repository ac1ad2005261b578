"""Drive a car on a hilly road."""
