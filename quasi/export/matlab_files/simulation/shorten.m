function vector = shorten(vector, most)
%SHORTEN  A plane vector, 1 x 2, no longer than most.
long = sqrt(vector(1)^2 + vector(2)^2);
if long > most
    vector = vector*most/long;
end
end
