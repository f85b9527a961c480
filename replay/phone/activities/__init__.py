"""What a simulated person does with the phone: rests, carrying, and how they are planned."""
