"""What the project claims about speed and accuracy, measured; answers are compared first."""
