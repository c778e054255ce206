"""Study: on which parameters does the objective depend?"""
