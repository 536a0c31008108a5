function wrapped = wrapAngle(angle)
%WRAPANGLE  Angle brought to +-pi, rad; halves of a turn go to the even one, so that +-pi stay as they are.
turns = angle/(2*pi);
whole = round(turns);
tie = abs(turns - fix(turns)) == 0.5;
whole(tie) = 2*round(turns(tie)/2);
wrapped = angle - 2*pi*whole;
end
