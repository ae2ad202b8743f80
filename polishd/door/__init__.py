"""What stands at the door of all that polishd serves over HTTP: who asks, from where, how much and how often."""
