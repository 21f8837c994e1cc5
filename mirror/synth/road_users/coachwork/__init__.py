"""How bodies of vehicles are made: sheets, shells of them, what is fitted to them, and the drawing that says where."""
