"""One plain function per use case: all that the command line may call."""
