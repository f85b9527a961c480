"""What is linear in a recording's residuals, measured alike in two recordings: constants and slow effects."""
