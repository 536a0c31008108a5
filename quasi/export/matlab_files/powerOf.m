function y = powerOf(base, exponent)
%POWEROF  base.^exponent; NaN where a negative base has a broken exponent, never complex.
[base, exponent] = deal(base + zeros(size(exponent)), exponent + zeros(size(base)));
base(base < 0 & exponent ~= fix(exponent)) = NaN;
y = base.^exponent;
end
