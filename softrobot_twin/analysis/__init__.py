"""What a state tells beside the step: compliances, derivatives, a linear model, the error of its mesh."""
