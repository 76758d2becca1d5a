"""What is simulated: the oscillator, its gap and the contact laws."""
