"""What walls do to sound: absorption and scattering, kept apart."""
