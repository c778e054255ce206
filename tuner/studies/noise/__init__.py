"""Study: does the objective tell configurations apart?"""
