function filter = lowPass(filter, value, dt, memory)
%LOWPASS  Second-order low-pass filter over one step, trapezoidal rule: fields value, slope (its derivative), input.
slope = memory.keep*filter.slope + memory.gain*(filter.input + value - 2*filter.value);
filter.value = filter.value + 0.5*dt*(filter.slope + slope);
filter.slope = slope;
filter.input = value;
end
