"""What does the exploration strategy do to the learning of a policy-gradient agent?"""
